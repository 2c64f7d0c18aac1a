"""Two logs of one motion, with a clock each, as one table of standstills."""
