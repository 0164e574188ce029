"""What the records hold: their channels and sizes, and whether they can determine an answer."""
