/* Makes the k-th call of a kind fail, of those that write into one folder; loaded before libc (LD_PRELOAD). */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

enum { WRITE, SYNC, RENAME, LINK, CREATE, UNLINK, MKDIR, KINDS };
enum { FAIL, FULL, KILL };

static char folder[4096];
static int armed = -1, how, reason;
static long left, seen[KINDS];

void faults_arm(const char *in, int kind, long k, int mode, int error) {
    snprintf(folder, sizeof folder, "%s/", in);
    armed = kind, left = k, how = mode, reason = error;
    memset(seen, 0, sizeof seen);
}

long faults_seen(int kind) { return seen[kind]; }

/* 0: do it; -1: fail; 1: do half of it, and fail from now on */
static int struck(int kind) {
    seen[kind]++;
    if (kind != armed) return 0;
    left--;
    if (left > 0 || (left < 0 && how != FULL)) return 0;
    if (how == KILL) kill(getpid(), SIGKILL);
    if (how == FULL && left == 0) return 1;
    errno = reason;
    return -1;
}

static int here(const char *path) {
    char full[8192], cwd[4096];
    if (!folder[0] || !path) return 0;
    if (path[0] == '/') return !strncmp(path, folder, strlen(folder));
    if (!getcwd(cwd, sizeof cwd)) return 0;
    snprintf(full, sizeof full, "%s/%s", cwd, path);
    return !strncmp(full, folder, strlen(folder));
}

static int of_folder(int fd) {
    char link[64], path[4096];
    if (!folder[0]) return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t n = readlink(link, path, sizeof path - 2);
    if (n <= 0) return 0;
    path[n] = '/', path[n + 1] = 0;
    return !strncmp(path, folder, strlen(folder));
}

#define REAL(name) __typeof__(name) *real = (__typeof__(name) *)dlsym(RTLD_NEXT, #name)

ssize_t write(int fd, const void *data, size_t n) {
    REAL(write);
    int s = of_folder(fd) ? struck(WRITE) : 0;
    return s < 0 ? -1 : real(fd, data, s && n > 1 ? n / 2 : n);
}

ssize_t writev(int fd, const struct iovec *parts, int n) {
    REAL(writev);
    int s = of_folder(fd) ? struck(WRITE) : 0;
    return s < 0 ? -1 : real(fd, parts, s && n > 1 ? n / 2 : n);
}

int fsync(int fd) {
    REAL(fsync);
    return of_folder(fd) && struck(SYNC) ? (errno = reason, -1) : real(fd);
}

int rename(const char *from, const char *to) {
    REAL(rename);
    return here(to) && struck(RENAME) ? (errno = reason, -1) : real(from, to);
}

int link(const char *from, const char *to) {
    REAL(link);
    return here(to) && struck(LINK) ? (errno = reason, -1) : real(from, to);
}

int linkat(int a, const char *from, int b, const char *to, int flags) {
    REAL(linkat);
    return here(to) && struck(LINK) ? (errno = reason, -1) : real(a, from, b, to, flags);
}

int unlink(const char *path) {
    REAL(unlink);
    return here(path) && struck(UNLINK) ? (errno = reason, -1) : real(path);
}

int mkdir(const char *path, mode_t mode) {
    REAL(mkdir);
    return here(path) && struck(MKDIR) ? (errno = reason, -1) : real(path, mode);
}

static int opened(const char *name, const char *path, int flags, mode_t mode) {
    int (*real)(const char *, int, ...) = (int (*)(const char *, int, ...))dlsym(RTLD_NEXT, name);
    return (flags & O_CREAT) && here(path) && struck(CREATE) ? (errno = reason, -1) : real(path, flags, mode);
}

#define OPEN(name)                                                                                                     \
    int name(const char *path, int flags, ...) {                                                                       \
        va_list rest;                                                                                                  \
        va_start(rest, flags);                                                                                         \
        mode_t mode = va_arg(rest, mode_t);                                                                            \
        va_end(rest);                                                                                                  \
        return opened(#name, path, flags, mode);                                                                       \
    }
OPEN(open)
OPEN(open64)
