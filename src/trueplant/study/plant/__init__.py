"""The estimate, the updated plant, verdicts and what lies behind them."""
