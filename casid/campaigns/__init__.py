"""Many runs of one function, resumable, on all cores or a cluster."""
