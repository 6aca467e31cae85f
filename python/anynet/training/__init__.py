"""Training: `recipe.Recipe` says what to do, `loop.train` does it."""
