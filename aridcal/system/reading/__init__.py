"""What a user names: files, read safely, under names that can be shown."""
