"""The three torque balances of a joint as filtered columns: motor side, transmission, link side."""
