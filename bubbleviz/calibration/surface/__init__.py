"""The reference surface: membrane pixels, cap fits, free form, rim."""
