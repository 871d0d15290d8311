"""`python -m physkin_training`: the same as `physkin train`."""

from physkin_training.train.train import main

raise SystemExit(main())
