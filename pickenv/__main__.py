"""`python -m pickenv` is the command line."""

from pickenv.cli import main

if __name__ == "__main__":
    main()
