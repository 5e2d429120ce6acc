"""Frame -> files: EXR, PNG, false colour, video, contact sheet, manifest; each whole or not at all.

Nothing here renders or decides what to render: each module takes arrays and writes one kind of
file, byte for byte the same for the same pixels, so that two runs can be compared by hash.
"""
