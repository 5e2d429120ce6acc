"""Raw mesh in, Asset out: ingest, clean, simplify, unwrap, bake.

Light to import: nothing native is loaded here, and `prepare` itself never loads pymeshlab, xatlas
or fast-simplification into the calling process (they run in child processes, see `worker`).
"""
