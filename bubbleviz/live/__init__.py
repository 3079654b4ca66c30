"""Live sources: messages as they come, frames made of them, a recorder, results out."""
