"""What people look at: pages, pictures, words. Nothing is computed here."""
