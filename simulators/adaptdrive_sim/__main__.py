"""`python -m adaptdrive_sim` is `adaptdrive-sim`."""

from adaptdrive_sim.cli import main

if __name__ == "__main__":
    main()
