"""The CAN link: bus, reader, reconnection, arrival of frames, their codec and integrity."""
