"""Error, stability and run time, measured against references and peers."""
