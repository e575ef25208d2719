"""Two models under one interaction over time, and the parameters with which they agree best."""
