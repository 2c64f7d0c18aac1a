"""Files that appear whole or not at all, whatever stops a command."""
