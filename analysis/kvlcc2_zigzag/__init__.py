"""A real hull in zigzags: what drives its roll, and what the rudder adds."""
