"""Real-time soft-tissue simulation: geometry, elastic models, holds and the loop that runs them."""
