"""Every model at equal cost per frame, ordered by its error."""
