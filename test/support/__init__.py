"""What tests of several packages share; `test/` is on the path of every test."""
