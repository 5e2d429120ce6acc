"""`python -m scanrender`."""

from scanrender.cli.main import main

if __name__ == "__main__":
    main()
