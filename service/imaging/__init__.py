"""From bytes to a measurement: decoding, background model, log-ratio map."""
