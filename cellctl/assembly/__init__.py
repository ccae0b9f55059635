"""What the cycle is made of: looking, handling, locating, and how sure each placement is."""
