"""The diagnosis on a page, in figures and as text."""
