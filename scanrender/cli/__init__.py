"""The command line: thin. Parses, calls, prints. `--help` imports neither NumPy nor GL."""
