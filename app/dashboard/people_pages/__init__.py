"""Pages of studies, participants, phones, staff, sign-in, webhooks and the audit log."""
