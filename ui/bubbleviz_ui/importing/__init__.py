"""What is no recording yet is made one."""
