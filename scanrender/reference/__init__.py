"""Float64 truth that the renderer is judged against; it uses profiles, never filter kernels."""
