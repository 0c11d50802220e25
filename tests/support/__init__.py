"""What tests share: places, makers of diagrams and FMUs, cases, watchers, independent solutions."""
