"""Effects that nobody declared; whether the rest is noise, and on what it depends."""
