"""OpenEXR files of a Frame: float32, lossless, the same bytes for the same pixels.

Layers are `name.X` with a letter first and exactly one dot, because Nuke splits channel names at
dots, tev and Blender group by them, and an unnamed R,G,B,A is the only picture that ffmpeg, Resolve
and thumbnailers find. Three layouts:

    single      one part holds everything (default: Cryptomatte plug-ins, After Effects and Fusion
                stumble over several parts)
    multipart   one part a buffer, named after it, with full channel names (Nuke reads one layer
                without decoding the others)
    per_buffer  one file a buffer, `<stem>.<name>.exr`

Every file states Rec.709 chromaticities and a colour interop id, and says for each layer its unit,
space and meaning in the attributes `scanrender/<name>/unit`, `.../space` and `.../meaning`.

How to check a file alone: `oiiotool --info -v FILE.exr`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt
import OpenImageIO

import scanrender
from scanrender.buffers import LINEAR, BufferSpec, Frame, buffer_spec
from scanrender.errors import OutputError, ScanError, UsageError
from scanrender.files import atomic_path

Image = npt.NDArray[np.float32]
Layout = Literal["single", "multipart", "per_buffer"]

DISPLAY_SPACE = "sRGB display"  # BufferSpec.space of `display`, the one buffer that is encoded

# ITU-R BT.709-6: x, y of red, green, blue, and of the white point D65.
REC709_CHROMATICITIES = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)

# OpenImageIO stamps the moment of writing unless a date is given; two runs would never agree.
FIXED_DATE = "1970:01:01 00:00:00"

_SHORT_NAMES = {"R": "beauty", "G": "beauty", "B": "beauty", "A": "alpha"}
_CHANNEL_ORDER = "RGBAXYZ"


@dataclass(frozen=True)
class _Layer:
    """One buffer on its way into a file; `pixels` (h, w, c) with one entry of `channels` each."""

    spec: BufferSpec
    channels: tuple[str, ...]
    pixels: Image

    @property
    def colour_id(self) -> str:
        """Color Interop Forum id: what the numbers are, not how they look."""
        if self.spec.space == LINEAR and self.spec.kind == "colour":
            return "lin_rec709_scene"
        return "srgb_rec709_display" if self.spec.space == DISPLAY_SPACE else "data"


@dataclass(frozen=True)
class _Part:
    """One OpenEXR part (OpenImageIO: subimage): the layers of one size, concatenated."""

    name: str
    layers: tuple[_Layer, ...]

    @property
    def size(self) -> tuple[int, int]:
        height, width = self.layers[0].pixels.shape[:2]
        return height, width


def write_exr(
    path: Path | str,
    frame: Frame,
    *,
    layout: Layout = "single",
    names: Sequence[str] | None = None,
) -> tuple[Path, ...]:
    """Write buffers of `frame` as float32 OpenEXR; returns the files, the named one last.

    `names` None means every buffer but `display`, which is not scene-linear and has its PNG. In the
    `single` layout a buffer of another size than the picture (shadow maps), and `display` when it
    is asked for, go into their own file `<stem>.<name>.exr`: one part has one size and one colour
    space. Pixels are stored bit for bit, NaN and Inf included. A file appears whole or not at all.

    Raises UsageError for a layout or buffer that does not exist, OutputError when a file cannot be
    written.
    """
    path = Path(path)
    if layout not in get_args(Layout):
        choices = ", ".join(get_args(Layout))
        raise UsageError(f"no EXR layout is called {layout!r}", fix=f"choose one of {choices}")
    layers = [_layer(frame, name) for name in _chosen_names(frame, names)]
    own_files: list[_Layer] = []
    main = layers
    if layout == "per_buffer":
        own_files, main = layers, []
    elif layout == "single":
        own_files = [layer for layer in layers if not _fits_picture(layer, frame)]
        main = [layer for layer in layers if _fits_picture(layer, frame)]

    written = []
    for layer in own_files:
        target = path.with_name(f"{path.stem}.{layer.spec.name}.exr")
        written.append(_write_file(target, [_Part(layer.spec.name, (layer,))]))
    if main and layout == "single":
        written.append(_write_file(path, [_Part("", tuple(main))]))
    elif main:
        written.append(_write_file(path, [_Part(layer.spec.name, (layer,)) for layer in main]))
    return tuple(written)


def read_exr(path: Path | str) -> dict[str, Image]:
    """Every layer of every part: name -> (h, w, c) float32, bit for bit as stored.

    The unnamed R,G,B become `beauty` and the unnamed A becomes `alpha` (h, w, 1). Channels are in
    the order R,G,B,A or X,Y,Z. Raises ScanError when the file is absent or unreadable.
    """
    source = OpenImageIO.ImageInput.open(str(path))
    if source is None:
        raise ScanError(f"cannot read EXR {path}: {OpenImageIO.geterror()}", where=str(path))
    layers: dict[str, Image] = {}
    try:
        part = 0
        while source.seek_subimage(part, 0):
            spec = source.spec()
            pixels = source.read_image(part, 0, 0, spec.nchannels, OpenImageIO.FLOAT)
            if pixels is None:
                raise ScanError(f"cannot decode EXR {path}: {source.geterror()}", where=str(path))
            pixels = pixels.reshape(spec.height, spec.width, spec.nchannels)
            for name, columns in _columns_by_layer(spec.channelnames).items():
                layers[name] = np.ascontiguousarray(pixels[:, :, columns], dtype=np.float32)
            part += 1
    finally:
        source.close()
    return layers


def layers_of(path: Path | str, at_once: int = 128 << 20) -> Iterator[tuple[str, Image]]:
    """What `read_exr` reads, `alpha` first, with at most about `at_once` bytes in memory: a frame
    with all of its buffers takes a gigabyte. Raises ScanError as `read_exr` does."""
    source = OpenImageIO.ImageInput.open(str(path))
    if source is None:
        raise ScanError(f"cannot read EXR {path}: {OpenImageIO.geterror()}", where=str(path))
    try:
        part = 0
        while source.seek_subimage(part, 0):
            spec = source.spec()
            most = max(3, at_once // max(1, 4 * spec.width * spec.height))
            columns = _columns_by_layer(spec.channelnames)
            groups: list[list[str]] = [[]]
            for name in sorted(columns, key=lambda name: (name != "alpha", columns[name])):
                if sum(len(columns[other]) for other in (*groups[-1], name)) > most and groups[-1]:
                    groups.append([])
                groups[-1].append(name)
            for group in groups:
                wanted = [column for name in group for column in columns[name]]
                first, last = min(wanted), max(wanted) + 1
                pixels = source.read_image(part, 0, first, last, OpenImageIO.FLOAT)
                if pixels is None:
                    what = f"cannot decode EXR {path}: {source.geterror()}"
                    raise ScanError(what, where=str(path))
                pixels = pixels.reshape(spec.height, spec.width, last - first)
                for name in group:
                    own = [column - first for column in columns[name]]
                    yield name, np.ascontiguousarray(pixels[:, :, own], dtype=np.float32)
            part += 1
    finally:
        source.close()


def _chosen_names(frame: Frame, names: Sequence[str] | None) -> list[str]:
    """The buffers to write, beauty first: many readers show the first part and nothing else."""
    if names is None:
        names = [name for name in frame.buffers if name != "display"]
    for name in names:
        if name not in frame.buffers:
            held = ", ".join(frame.buffers)
            raise UsageError(f"the frame has no buffer {name!r}", fix=f"it holds {held}")
    if not names:
        raise UsageError("no buffer was chosen for the EXR file")
    return sorted(dict.fromkeys(names), key=lambda name: name != "beauty")


def _layer(frame: Frame, name: str) -> _Layer:
    """`name` as float32 (h, w, c); beauty takes the coverage along as unnamed R,G,B,A."""
    spec = buffer_spec(name)
    channels = spec.channels
    pixels = np.asarray(frame.buffers[name], dtype=np.float32)
    if pixels.ndim == 2:
        pixels = pixels[:, :, None]
    if name == "beauty":
        channels = ("R", "G", "B", "A")
        pixels = np.concatenate([pixels, frame.alpha[:, :, None]], axis=2, dtype=np.float32)
    if pixels.shape[2] != len(channels):
        raise ValueError(f"buffer {name} has shape {pixels.shape} for channels {channels}")
    return _Layer(spec, channels, pixels)


def _fits_picture(layer: _Layer, frame: Frame) -> bool:
    same_size = layer.pixels.shape[:2] == frame.alpha.shape
    return same_size and layer.colour_id != "srgb_rec709_display"


def _image_spec(part: _Part, picture_size: tuple[int, int]) -> Any:
    """OpenImageIO's header of one part; `picture_size` (h, w) is the file's display window."""
    height, width = part.size
    channels = tuple(channel for layer in part.layers for channel in layer.channels)
    spec = OpenImageIO.ImageSpec(width, height, len(channels), OpenImageIO.FLOAT)
    spec.channelnames = channels
    # OpenEXR wants one display window in all parts of a file, whatever their own size.
    spec.full_height, spec.full_width = picture_size
    spec.attribute("compression", "zip")  # lossless; dwaa/dwab would alter data layers
    spec.attribute("DateTime", FIXED_DATE)
    spec.attribute("Software", f"scanrender {scanrender.__version__}")
    spec.attribute("chromaticities", OpenImageIO.TypeDesc("float[8]"), REC709_CHROMATICITIES)
    ids = {layer.colour_id for layer in part.layers}
    # The id describes the colour channels of a part; "data" only where there are none.
    colour_id = ids.pop() if len(ids) == 1 else "lin_rec709_scene"
    spec.attribute("oiio:ColorSpace", colour_id)
    spec.attribute("colorInteropID", colour_id)
    if part.name:
        spec.attribute("oiio:subimagename", part.name)
    for layer in part.layers:
        for key in ("unit", "space", "meaning"):
            spec.attribute(f"scanrender/{layer.spec.name}/{key}", getattr(layer.spec, key))
    return spec


def _write_file(path: Path, parts: Sequence[_Part]) -> Path:
    """Write `parts` into one file, atomically. Raises OutputError."""
    specs = [_image_spec(part, parts[0].size) for part in parts]
    with atomic_path(path) as temporary:
        target = OpenImageIO.ImageOutput.create(str(temporary))
        if target is None:
            raise OutputError(f"cannot write EXR {path}: {OpenImageIO.geterror()}", where=str(path))
        opened = target.open(str(temporary), tuple(specs) if len(specs) > 1 else specs[0])
        done = opened and all(
            (index == 0 or target.open(str(temporary), spec, "AppendSubimage"))
            and target.write_image(_pixels(part))
            for index, (spec, part) in enumerate(zip(specs, parts, strict=True))
        )
        error = "" if done else target.geterror()
        # Close in every case: an open handle keeps the temporary file from being removed (Windows).
        closed = target.close() if opened else False
        if not (done and closed):
            raise OutputError(
                f"cannot write EXR {path}: {error or target.geterror() or 'the disk may be full'}",
                where=str(path),
                fix="choose another folder with --out, or free space and permissions there",
            )
    return path


def _pixels(part: _Part) -> Any:
    # Contiguous, since OpenImageIO took wrong strides from views (OpenImageIO#4843).
    layers = [layer.pixels for layer in part.layers]
    return np.ascontiguousarray(layers[0] if len(layers) == 1 else np.concatenate(layers, axis=2))


def _columns_by_layer(channels: Sequence[str]) -> dict[str, list[int]]:
    """Layer name -> its column numbers, in the order R,G,B,A or X,Y,Z."""
    columns: dict[str, list[int]] = {}
    for column, channel in enumerate(channels):
        layer = channel.rpartition(".")[0] or _SHORT_NAMES.get(channel, channel)
        columns.setdefault(layer, []).append(column)

    def rank(column: int) -> tuple[int, str]:
        suffix = channels[column].rpartition(".")[2]
        return (_CHANNEL_ORDER.find(suffix) % 8, suffix)  # -1 becomes 7: unknown suffixes last

    return {layer: sorted(found, key=rank) for layer, found in columns.items()}
