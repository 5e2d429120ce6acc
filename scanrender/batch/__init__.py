"""Jobs: a scan and a pipeline in, a folder of results out. One bad scan never stops the others."""
