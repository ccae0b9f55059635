"""The groups of commands, one module each; `cellctl/__main__.py` puts them together."""
