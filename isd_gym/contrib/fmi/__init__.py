"""Networks written as functional mock-up units (FMI)."""
