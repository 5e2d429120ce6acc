"""What can be told of a scan file by its name and first bytes; imports nothing slow."""

from __future__ import annotations

from pathlib import Path

from scanrender.errors import ScanError, UsageError

FORMATS = (".obj", ".ply", ".glb", ".gltf", ".stl", ".off")
_UNSUPPORTED = "export it as OBJ, PLY, GLB, glTF, STL or OFF"


def check_header(path: Path) -> None:
    """Refuse early, before loading, what cannot be a scan."""
    if not path.exists():
        raise UsageError(f"no such scan: {path}", str(path))
    if path.is_dir():
        raise ScanError(f"{path} is a folder, not a scan file", str(path), "name the mesh file")
    if not path.is_file():  # a pipe or a device would block, or never end
        raise ScanError(f"{path} is not a regular file", str(path), "copy the scan to a file")
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        kind = f"{suffix} files are" if suffix else "files without a suffix are"
        raise ScanError(f"{kind} not supported", str(path), _UNSUPPORTED)
    try:
        with path.open("rb") as stream:
            head = stream.read(4096)
    except OSError as error:
        raise ScanError(f"cannot read {path.name}: {error.strerror}", str(path)) from error
    if not head.strip():
        raise ScanError(f"{path.name} is empty", str(path), "export it again")
    magic = {".ply": b"ply", ".glb": b"glTF"}.get(suffix)
    if magic and not head.lstrip().startswith(magic):
        raise ScanError(
            f"{path.name} does not begin like a {suffix[1:].upper()} file", str(path), _UNSUPPORTED
        )
    if head.startswith(b"version https://git-lfs"):
        raise ScanError(f"{path.name} is a Git LFS pointer", str(path), "run: git lfs pull")


def named(error: ScanError, path: Path) -> ScanError:
    """The same error, saying which scan it is about."""
    return error if error.where else ScanError(f"{path.name}: {error.what}", str(path), error.fix)
