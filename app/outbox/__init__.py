"""Events for webhooks, written in the transaction of the event: the rows of webhooks and of their deliveries.

Sending, retrying and managing webhooks belongs to webhooks.
"""
