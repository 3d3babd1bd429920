"""The outbox: tables of webhooks and deliveries, which are written in the transaction of their event.

Sending, retrying and managing webhooks belong to app/webhooks.
"""
