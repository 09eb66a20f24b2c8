"""One world with several controllers: claims, orders, silence, pace and replay; no protocol is known here."""
