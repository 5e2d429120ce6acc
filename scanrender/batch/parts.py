"""Parts of a turn that other processes, or other machines, rendered into OUT/parts/.

A render farm's tasks must not write into one folder at the same time, so each range of frames goes
into its own (`run --frames 0-23 --out OUT/parts/0-23`); the run of the whole takes them over.
"""

from __future__ import annotations

import shutil

from scanrender.batch.jobs import Job
from scanrender.batch.record import Record, Stage, digest, load_record
from scanrender.batch.state import Work
from scanrender.files import atomic_path

PARTS = "parts"


def adopt_parts(job: Job, record: Record, work: Work) -> int:
    """Copy frames of the same settings, asset and code that are still to be rendered, after looking
    at their content. Returns how many. They are all of one driver: the first that is met."""
    if job.part is not None or not work.render or "frames" not in work.reads:
        return 0
    count = 0
    for folder in sorted(path for path in (job.folder / PARTS).glob("*") if path.is_dir()):
        theirs = load_record(folder)
        stage = theirs.stages.get("frames")
        own = record.stages.get("frames")
        if stage is None or (own is not None and own.files and own.key != stage.key):
            continue
        if digest({**work.reads["frames"], "gl": stage.reads.get("gl", "")}) != stage.key:
            continue
        if own is None or own.key != stage.key:
            own = record.put("frames", Stage(stage.key, stage.reads, notes={**stage.notes}))
        for index, names in stage.parts().items():
            if index in work.render and theirs.damaged(stage, names, verify=True) is None:
                with atomic_path(job.folder / job.frame_file(index)) as temporary:
                    shutil.copyfile(folder / names[0], temporary)
                record.add(own, job.frame_file(index), index)
                count += 1
        times = own.notes.setdefault("ms", {})
        own.notes["ms"] = {**stage.notes.get("ms", {}), **times}
    record.save()
    return count
