"""Campaigns and tables: bytes to rows and back."""
