"""What the two clients of ``service.client`` share: calls as data, retries, the stream's messages."""
