"""``python -m sapwood``: the commands where they are not on the path."""

from sapwood.cli.main import sapwood_main

if __name__ == "__main__":
    sapwood_main()
