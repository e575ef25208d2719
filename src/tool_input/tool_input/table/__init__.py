"""The operating table: one page for several people, and what each of them does there."""
