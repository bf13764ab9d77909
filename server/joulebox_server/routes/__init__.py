"""The HTTP routes: each handler reads its input, asks the store, and answers."""
