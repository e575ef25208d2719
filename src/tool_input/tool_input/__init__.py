"""Sources of tool motion: scripted procedures, replayed bags, a mouse page and CRTK arms."""
