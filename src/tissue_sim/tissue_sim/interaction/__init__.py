"""How tools act on tissue: holds and the forces they feel."""
