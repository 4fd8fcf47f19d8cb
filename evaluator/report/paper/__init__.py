"""What of an evaluation goes into a paper: figures and tables as files."""
