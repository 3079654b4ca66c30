"""Speed: run time by stage, growth with nodes and pixels, memory."""
