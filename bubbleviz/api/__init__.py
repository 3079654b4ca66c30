"""Public functions of the library, and the types that they return."""
