"""Bodies before clutter: followed by outline and texture where light tells no body from what lies about it."""
