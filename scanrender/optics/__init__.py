"""How skin scatters and reflects light: float64 NumPy, no GPU, no files.

``profiles`` holds the diffusion profiles, ``kernels`` turns a profile into filter taps by
exact cell integrals, ``surface`` holds the specular lobes. Lengths are millimetres, colours
linear Rec.709, and every function takes and returns float64 arrays.
"""
