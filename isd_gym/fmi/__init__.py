"""Functional mock-up units (FMI): units of others as models (`cosimulation`), and networks written as units (`export`)."""
