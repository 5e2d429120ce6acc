"""A raw scan to one picture with its buffers, step by step in Python.

    python examples/one_frame.py --out out/one_frame                 our own raw head
    python examples/one_frame.py --out out/one_frame scan.obj        a scan of yours

`scanrender run buffers SCAN` does the same. The guard at the end is needed: preparation runs in a
child process, so that a native library that dies takes nothing along.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from scanrender.outputs.exr import write_exr
from scanrender.outputs.png import write_frame_png
from scanrender.phantom import Damage, make_head, scan_head, write_ply
from scanrender.render.device import device
from scanrender.render.frame import Renderer
from scanrender.scan.prepare import prepare
from scanrender.settings.loading import load_pipeline

BUFFERS = ["position", "albedo", "irradiance", "diffuse", "specular"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("scan", type=Path, nargs="?", help="default: our own raw head")
    parser.add_argument("--out", type=Path, default=Path("out/one_frame"))
    parser.add_argument("--size", type=int, default=720, help="side of the picture in px")
    parser.add_argument("--map-size", type=int, default=1024, help="side of the maps in px")
    parser.add_argument("--triangles", type=int, default=30_000, help="of the prepared head")
    arguments = parser.parse_args()
    out = arguments.out

    # A shipped pipeline, a file, or either with overrides in the spelling of --set.
    pipeline = load_pipeline(
        "turntable",
        [
            f"camera.width_px={arguments.size}",
            f"camera.height_px={arguments.size}",
            f"prep.simplify.triangles={arguments.triangles}",
            f"prep.bake.albedo_px={arguments.map_size}",
            f"prep.bake.normal_px={arguments.map_size}",
            f"prep.bake.data_px={arguments.map_size // 2}",
        ],
    )

    scan = arguments.scan
    if scan is None:
        head = make_head(triangles=max(50_000, 4 * arguments.triangles))
        scan = write_ply(out / "head.ply", scan_head(head, Damage()))

    asset = prepare(scan, pipeline.scan, pipeline.prep, out / "asset")
    for sentence in asset.info["warnings"]:
        print("warning:", sentence)

    renderer = Renderer(device(), asset, pipeline)
    frame = renderer.render(renderer.view(0), BUFFERS)
    write_frame_png(out / "frame.png", frame)
    write_exr(out / "frame.exr", frame, names=["beauty", *BUFFERS])
    print(f"{out}/: frame.png, frame.exr, asset/ ({len(asset.mesh.faces):,} triangles)")


if __name__ == "__main__":
    main()
