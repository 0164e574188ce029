"""What a record cannot tell apart or show, and the experiment that would."""
