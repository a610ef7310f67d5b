"""The papers' own methods, kept to compare with."""
