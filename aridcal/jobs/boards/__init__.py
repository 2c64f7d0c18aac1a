"""Boards, tags and sockets to print, and what a camera sees of them."""
