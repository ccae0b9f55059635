"""The control socket: what people and programs may ask of the daemon, and the work that follows."""
