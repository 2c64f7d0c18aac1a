"""What people come for, as functions from arguments to results and files: commands and the Python face are two doors to it."""
