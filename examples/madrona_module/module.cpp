// The Python module that `gsb-record --sim madrona` drives: docs/madrona.md has its contract.
//
// Defined by the build: GSB_MODULE, the module's name; GSB_VERSION, a string that names the commits of Madrona and of
// these sources; GSB_MODIFIED, what is changed, where Madrona is not as published; for a GPU also MADRONA_CUDA_SUPPORT, GSB_GPU_SOURCES and GSB_GPU_FLAGS (see simulation.cpp).
#include "simulation.hpp"

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <atomic>
#include <cmath>
#include <cstdio>
#include <stdexcept>
#include <tuple>

#include <unistd.h>

namespace nb = nanobind;

namespace gsb {

namespace {

constexpr int32_t ownSubsteps = 4;           // as Madrona's examples have it
constexpr int64_t mostWorlds = 1 << 24;
constexpr double restitution = 0.3;          // written into Madrona's xpbd.cpp

enum class Mode { CPU, CUDA };

// Whatever is printed meanwhile goes to standard error: standard output has the recorder's results.
class Quiet {
public:
    Quiet() : kept_(dup(STDOUT_FILENO))
    {
        std::fflush(stdout);
        dup2(STDERR_FILENO, STDOUT_FILENO);
    }

    ~Quiet()
    {
        std::fflush(stdout);
        dup2(kept_, STDOUT_FILENO);
        close(kept_);
    }

    Quiet(const Quiet &) = delete;
    Quiet &operator=(const Quiet &) = delete;

private:
    int kept_;
};

// One at a time: Madrona keeps types, and on a GPU the heap, for the whole process.
class OnlyOne {
public:
    OnlyOne()
    {
        if (alive_.exchange(true)) {
            throw std::runtime_error("there is a SimManager in this process already; Madrona takes one at a time");
        }
    }

    ~OnlyOne() { alive_ = false; }

    OnlyOne(const OnlyOne &) = delete;
    OnlyOne &operator=(const OnlyOne &) = delete;

private:
    static inline std::atomic<bool> alive_ { false };
};

float number(nb::handle value)
{
    return float(nb::cast<double>(value));
}

template <size_t N>
std::array<float, N> numbers(nb::handle values)
{
    std::array<float, N> found;
    for (size_t i = 0; i < N; i++) {
        found[i] = number(values[i]);
    }
    return found;
}

Shape shapeOf(const std::string &kind, const std::string &name)
{
    if (kind == "box") {
        return Shape::Box;
    }
    if (kind == "sphere") {
        return Shape::Sphere;
    }
    if (kind == "plane") {
        return Shape::Plane;
    }
    throw std::invalid_argument("body '" + name + "' is a " + kind + "; Madrona has boxes, spheres and planes");
}

Body bodyOf(const nb::dict &record)
{
    nb::object shape = record["shape"], material = record["material"];
    auto name = nb::cast<std::string>(record["name"]);
    Body body {
        .name = name,
        .shape = shapeOf(nb::cast<std::string>(shape["kind"]), name),
        .edges = {},
        .radius = 0,
        .mass = record.contains("mass") ? number(record["mass"]) : 0.f,
        .staticFriction = number(material["static_friction"]),
        .kineticFriction = number(material["kinetic_friction"]),
        .position = numbers<3>(record["position"]),
        .orientation = numbers<4>(record["orientation"]),
        .linear = numbers<3>(record["linear_velocity"]),
        .angular = numbers<3>(record["angular_velocity"]),
    };
    if (body.shape == Shape::Box) {
        body.edges = numbers<3>(shape["size"]);
    } else if (body.shape == Shape::Sphere) {
        body.radius = number(shape["radius"]);
    }
    if (record.contains("mass") && !body.moves()) {
        throw std::invalid_argument("body '" + name + "' has a mass that is not above 0");
    }
    if (body.moves() && body.shape == Shape::Plane) {
        throw std::invalid_argument("body '" + name + "' is a plane that moves");
    }
    return body;
}

// Spheres that touch are pulled together: Madrona's narrowphase gives their normal the other way round than all others.
void refuseSpheres(const Scene &scene)
{
    std::string first;
    bool moves = false;
    for (const Body &body : scene.bodies) {
        if (body.shape != Shape::Sphere) {
            continue;
        }
        moves = moves || body.moves();
        if (!first.empty() && moves) {
            throw std::invalid_argument(
                "'" + first + "' and '" + body.name + "' are spheres, which attract each other in Madrona");
        }
        first = body.name;
    }
}

Scene sceneOf(const std::string &json)
{
    auto record = nb::cast<nb::dict>(nb::module_::import_("json").attr("loads")(json));
    for (const char *unknown : { "robot", "model", "actions" }) {
        if (record.contains(unknown)) {
            throw std::invalid_argument("the scene has a " + std::string(unknown) + "; this module has free bodies alone");
        }
    }
    Scene scene { .bodies = {}, .gravity = numbers<3>(record["gravity"]) };
    for (nb::handle body : nb::cast<nb::list>(record["bodies"])) {
        scene.bodies.push_back(bodyOf(nb::cast<nb::dict>(body)));
    }
    refuseSpheres(scene);
    return scene;
}

class SimManager {
public:
    SimManager(Mode mode, int64_t gpu, int64_t worlds, uint64_t /* seed: nothing is drawn */, bool reset,
               const std::string &scene, double deltaT, int64_t substeps)
        : scene_(sceneOf(scene)),
          settings_ {
              .cuda = mode == Mode::CUDA,
              .gpu = int(gpu),
              .worlds = uint32_t(worlds),
              .deltaT = float(deltaT),
              .substeps = substeps ? int32_t(substeps) : ownSubsteps,
          }
    {
        if (reset) {
            throw std::invalid_argument("auto_reset: worlds are never reset");
        }
        if (worlds < 1 || worlds > mostWorlds) {
            throw std::invalid_argument("num_worlds is from 1 to " + std::to_string(mostWorlds));
        }
        for (const Body &body : scene_.bodies) {
            if (body.moves()) {
                names_.push_back(body.name);
            }
        }
        if (names_.empty()) {
            throw std::invalid_argument("no body of the scene moves");
        }
        Quiet quiet;
        simulation_ = std::make_unique<Simulation>(scene_, settings_);
    }

    void step() { simulation_->step(); }

    const std::vector<std::string> &names() const { return names_; }

    nb::dict settings() const
    {
        const auto &g = scene_.gravity;
        double size = std::sqrt(double(g[0]) * g[0] + double(g[1]) * g[1] + double(g[2]) * g[2]);
        nb::dict found;
        found["solver"] = "XPBD";
        found["num_substeps"] = settings_.substeps;
        found["delta_t"] = double(settings_.deltaT);
        found["gravity"] = nb::make_tuple(g[0], g[1], g[2]);
        found["restitution"] = restitution;
        found["restitution_threshold"] = 2 * size * settings_.deltaT / settings_.substeps;  // [m/s]
        found["friction_combination"] = "the mean of the two";
        found["kinetic_friction"] =
            "impulse limited to mu lambda_n / (h w^2): lambda_n of the positions alone, w the generalised inverse mass";
        found["contact_points"] = "normal: one for a pair, the mean of up to four weighted by depth; friction: each";
        found["contacts_counted"] = false;
#ifdef GSB_MODIFIED
        found["modified"] = GSB_MODIFIED;  // tables then call the engine MODIFIED
#endif
        return found;
    }

    using Row = std::tuple<std::string, std::string, std::string, std::string>;

    std::vector<Row> deviations() const
    {
        return {
            { "contact.kinetic_friction", "mu times the normal force, at any mass",
              "mu times the normal force times the square of the effective mass in kg",
              "xpbd.cpp multiplies by the effective mass where it should divide" },
            { "contact.friction_normal_force", "what holds the bodies apart",
              "that of the position solve alone, which is 1.14 times the weight of a cube that slides with 0.25",
              "xpbd.cpp takes the rest back while it solves velocities, and friction does not count that" },
            { "contact.restitution", "at every speed",
              "none where bodies close at less than restitution_threshold",
              "as Madrona sets it: twice gravity times a substep" },
            { "contact.points", "each of its own", "their mean, weighted by depth",
              "Madrona solves one point for a pair of bodies" },
        };
    }

    nb::object positions(nb::handle self) const { return tensor(self, simulation_->positions(), 3); }
    nb::object rotations(nb::handle self) const { return tensor(self, simulation_->rotations(), 4); }
    nb::object velocities(nb::handle self) const { return tensor(self, simulation_->velocities(), 6); }

private:
    nb::object tensor(nb::handle owner, float *data, size_t width) const
    {
        size_t shape[] { settings_.worlds, names_.size(), width };
        if (settings_.cuda) {
            nb::ndarray<nb::pytorch, float> found(
                data, 3, shape, owner, nullptr, nb::dtype<float>(), nb::device::cuda::value, settings_.gpu);
            return nb::cast(found, nb::rv_policy::reference);
        }
        return nb::cast(nb::ndarray<nb::numpy, float>(data, 3, shape, owner), nb::rv_policy::reference);
    }

    OnlyOne only_;
    Scene scene_;
    Settings settings_;
    std::vector<std::string> names_;
    std::unique_ptr<Simulation> simulation_;
};

}

}

NB_MODULE(GSB_MODULE, m)
{
    using gsb::Mode, gsb::SimManager;
    nb::set_leak_warnings(false);  // tensors may outlive the module, at the end of the interpreter
    nb::module_ madrona = m.def_submodule("madrona");
    nb::enum_<Mode>(madrona, "ExecMode").value("CPU", Mode::CPU).value("CUDA", Mode::CUDA);
    m.def("version", [] { return GSB_VERSION; });
    using Self = nb::handle_t<SimManager>;
    nb::class_<SimManager>(m, "SimManager")
        .def(nb::init<Mode, int64_t, int64_t, uint64_t, bool, const std::string &, double, int64_t>(),
             nb::arg("exec_mode"), nb::arg("gpu_id"), nb::arg("num_worlds"), nb::arg("rand_seed"),
             nb::arg("auto_reset"), nb::arg("scene"), nb::arg("delta_t"), nb::arg("num_substeps"))
        .def("step", &SimManager::step, nb::call_guard<nb::gil_scoped_release>())
        .def("body_names", &SimManager::names)
        .def("settings", &SimManager::settings)
        .def("deviations", &SimManager::deviations)
        .def("position_tensor", [](Self self) { return nb::cast<SimManager &>(self).positions(self); })
        .def("rotation_tensor", [](Self self) { return nb::cast<SimManager &>(self).rotations(self); })
        .def("velocity_tensor", [](Self self) { return nb::cast<SimManager &>(self).velocities(self); });
}
