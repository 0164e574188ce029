"""Documents as HTML: the shell of a page, its parts, and what a notebook shows."""
