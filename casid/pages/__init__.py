"""Pages that open offline: their markup, their look, and the page of an estimate."""
