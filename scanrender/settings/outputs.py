"""`outputs:` what is written, and for which frames."""

from __future__ import annotations

import difflib
from typing import Literal

from pydantic import field_validator

from scanrender.buffers import CATALOGUE, buffer_spec
from scanrender.errors import UsageError
from scanrender.settings.base import Section, setting


class OutputSettings(Section):
    """Files of one scan's folder."""

    video: bool = setting(True, "Write turntable.mp4 (H.264).", unit="")
    frames: bool = setting(False, "Write each frame as a PNG under frames/.", unit="")
    contact_sheet: bool = setting(True, "Write contact_sheet.png.", unit="")
    contact_frames: int = setting(
        12, "Pictures on the contact sheet, spread over the turn.", unit="1", ge=1, le=200
    )
    buffers: tuple[str, ...] = setting((), "Buffers to dump, by name; `all` is every one.", unit="")
    buffer_frames: tuple[int, ...] = setting(
        (0,), "Frames whose buffers are dumped (0-based).", unit=""
    )
    false_colour: bool = setting(
        True, "Beside each dumped EXR, a PNG of each buffer with a legend.", unit=""
    )
    exr_layout: Literal["single", "multipart", "per_buffer"] = setting(
        "single", "One part for all layers, one part each, or one file each.", unit=""
    )

    @field_validator("buffers")
    @classmethod
    def _buffers_exist(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        """Said now, not after minutes of preparation."""
        for name in names:
            try:
                known = name == "all" or bool(buffer_spec(name))
            except UsageError:
                known = False
            if not known:
                hint = difflib.get_close_matches(name, CATALOGUE, 1)
                meant = f", did you mean {hint[0]!r}?" if hint else ""
                raise ValueError(f"no buffer is called {name!r}{meant}")
        return names
