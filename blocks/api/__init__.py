"""What a person calls: Diagram and Run."""
