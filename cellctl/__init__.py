"""The controller: decides what the cell does. Knows no byte, no port number, no socket of a device."""
