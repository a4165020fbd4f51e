"""The filters: filterpy's verbs around a window or a recursion."""
