"""The process that blocks runs in: its memory, garbage collector, locks of files and notebook."""
