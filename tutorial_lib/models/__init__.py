"""The networks, each readable in one sitting: a frozen configuration and an ``nn.Module`` beside it."""
