"""Functional mock-up units (FMI): units of users as models (`cosimulation`), and networks written as units (`export`)."""
