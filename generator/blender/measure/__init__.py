"""Measurements that need rendered pictures: paired renders, plans, experiments."""
