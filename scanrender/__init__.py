"""scanrender: a raw 3D scan of a person goes in, a believable skin turntable comes out."""

__version__ = "0.1.0"
