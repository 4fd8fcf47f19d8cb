"""Text for LaTeX: whatever a recording says, pdfLaTeX sets it and obeys none of it."""

from __future__ import annotations

from gpusimbench.schemas.text import printable

_SPECIAL = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "#": r"\#", "%": r"\%", "_": r"\_",
    "^": r"\textasciicircum{}", "~": r"\textasciitilde{}", "<": r"\textless{}", ">": r"\textgreater{}",
    "|": r"\textbar{}", '"': r"\textquotedblright{}", "`": r"\textasciigrave{}", "'": r"\textquotesingle{}",
}  # fmt: skip

_SIGNS = {
    "±": r"$\pm$", "×": r"$\times$", "−": "$-$", "≤": r"$\le$", "≥": r"$\ge$", "µ": r"$\mu$", "°": r"$^\circ$",
    "→": r"$\to$", "–": "--", "—": "---", "…": r"\dots{}", "“": "``", "”": "''", "‘": "`", "’": "'",
    "\u2009": r"\,", "\u202f": r"\,", "\u00a0": "~",
}  # fmt: skip

_RAISED = dict(
    zip("\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079\u207a\u207b", "0123456789+-", strict=True)
)
_LAST_LATIN = 0x17F  # what LaTeX knows without a package
_NEEDS_T1 = frozenset("ÐðÞþĄąĐđĘęĮįŊŋŲų")  # errors with LaTeX's default fonts
_UNKNOWN = frozenset("ĦħĸĿŀŉŦŧſ")  # errors with any


def escape(text: str) -> str:
    """Text in which nothing is a command; what pdfLaTeX has no letter for stands as its number."""
    return "".join(map(_letter, printable(text)))


def _letter(c: str) -> str:
    if c in _SPECIAL:
        return _SPECIAL[c]
    if c in _SIGNS:
        return _SIGNS[c]
    if c in _RAISED:
        return f"$^{{{_RAISED[c]}}}$"
    if c.isspace():
        return " "
    known = c.isalpha() and ord(c) <= _LAST_LATIN and c not in _NEEDS_T1 | _UNKNOWN
    return c if c.isascii() or known else f"[U+{ord(c):04X}]"


def figure(file_name: str, caption: str) -> str:
    """A floating figure of a file, with its caption and a label of the same name."""
    return (
        "\\begin{figure}\n  \\centering\n"
        f"  \\includegraphics[width=\\linewidth]{{{file_name}}}\n"
        f"  \\caption{{{escape(caption)}}}\n  \\label{{fig:{file_name}}}\n\\end{{figure}}\n"
    )
