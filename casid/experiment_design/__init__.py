"""Which record to take next: inputs designed under the limits of what can be done."""
