"""`adaptdrive-sim demo`: a story of a simulated drive and its controller, and a view of it."""
