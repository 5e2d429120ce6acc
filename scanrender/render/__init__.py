"""Asset + scene -> named buffers, on a GPU or a software rasterizer. Never imports `scan`."""
