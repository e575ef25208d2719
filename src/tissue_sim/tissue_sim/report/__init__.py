"""What a recorded session was like, in figures: how tools moved, what tissue bore, what was cut."""
