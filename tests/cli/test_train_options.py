"""The page that lists all options of `modpush train`."""

from tools.train_options import PAGE, page


def test_the_page_of_options_is_what_the_configurations_say() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "run python tools/train_options.py"
