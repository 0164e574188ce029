"""One effect refitted jointly with all parameters, and the kinds that need a scan for that."""
