"""The inverse problem: from a range image to displacement, contact pressure and patch."""
