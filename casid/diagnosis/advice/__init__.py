"""What the record cannot separate or show, and which experiment would."""
