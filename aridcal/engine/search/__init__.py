"""Search for effects that nobody declared; whether the residual is noise, and on what it depends."""
