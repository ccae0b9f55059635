"""What a person runs at a terminal: one module per command, each with or without the daemon."""
