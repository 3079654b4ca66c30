"""What is open, where the cursor is, what the user chose; no widgets."""
