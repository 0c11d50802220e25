"""What a block is: its declaration, its interface with sizes, its equations as a tape."""
