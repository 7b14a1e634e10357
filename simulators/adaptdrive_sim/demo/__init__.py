"""`adaptdrive-sim demo`: broker, simulated drive and daemon as processes, and a view of them."""
