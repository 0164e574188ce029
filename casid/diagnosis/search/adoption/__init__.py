"""The adopted causes revised as a set: sharpened, renamed, replaced or dropped."""
