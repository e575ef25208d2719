"""Sources of tool motion: scripted procedures, replayed bags, the operating table and CRTK arms."""
