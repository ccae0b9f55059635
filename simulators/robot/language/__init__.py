"""The robot language, as lines of a program and as online commands: text to what shall be done. Pure."""
