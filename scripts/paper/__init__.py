"""The paper's experiment: its methods, tables, figures and the reasons behind them."""
