"""What is believed: the equations of docs/model.md, one module each."""
