"""Rebuilds gsb_v1.binpb from proto/gsb/v1/*.proto (``make proto``). A test holds the two together."""

from __future__ import annotations

from pathlib import Path

HERE = Path(__file__).resolve().parent


def build(target: Path) -> None:
    """Write the descriptor set of all .proto files, comments included, to `target`."""
    from grpc_tools import protoc

    root = HERE / "proto"
    sources = sorted(str(p.relative_to(root)) for p in root.rglob("*.proto"))
    arguments = ["protoc", f"-I{root}", "--include_source_info", f"--descriptor_set_out={target}", *sources]
    if protoc.main(arguments) != 0:
        raise SystemExit("protoc failed")


if __name__ == "__main__":
    build(HERE / "gsb_v1.binpb")
