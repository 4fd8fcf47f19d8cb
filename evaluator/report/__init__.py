"""An evaluation presented: tables in a terminal, JSON for programs, one HTML page for people."""
