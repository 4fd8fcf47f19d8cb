"""Rebuilds the descriptor sets beside this module from proto/ (``make proto``). A test holds the two together."""

from __future__ import annotations

from pathlib import Path

from gpusimbench.schemas.messages import DESCRIPTOR_SETS

HERE = Path(__file__).resolve().parent


def build(target: Path, package: str = "gsb") -> None:
    """Write the descriptor set of a package's .proto files to `target`.

    Ours have their comments. Foxglove's, whose types viewers know, have none, and are together with all they refer to.
    """
    from importlib.resources import files

    from grpc_tools import protoc

    root = HERE / "proto"
    sources = sorted(str(p.relative_to(root)) for p in (root / package).rglob("*.proto"))
    kept = "--include_source_info" if package == "gsb" else "--include_imports"
    google = f"-I{files('grpc_tools') / '_proto'}"
    arguments = ["protoc", f"-I{root}", google, kept, f"--descriptor_set_out={target}", *sources]
    if protoc.main(arguments) != 0:
        raise SystemExit("protoc failed")


if __name__ == "__main__":
    for package, name in DESCRIPTOR_SETS.items():
        build(HERE / name, package)
