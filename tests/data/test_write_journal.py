import torch

from torchgrasp.data.write_journal import WriteJournal


def test_a_reader_gets_each_row_once_and_in_order():
    generator = torch.Generator().manual_seed(0)
    journal, unread, posts = WriteJournal(), set(), 0
    for turn in range(200):
        rows = torch.randint(1000, (int(torch.randint(30, (1,), generator=generator)),), generator=generator)
        journal.post(rows.unique())
        unread, posts = unread | set(rows.tolist()), posts + 1
        if turn % 7 == 0:
            assert journal.read().tolist() == sorted(unread)
            unread = set()
    assert journal.num_posts == posts


def test_a_long_run_is_one_entry_and_too_many_entries_are_told():
    journal = WriteJournal()
    journal.post(torch.arange(100_000))
    assert len(journal.read()) == 100_000
    journal.post(torch.arange(0, 2 * 1024, 2))
    assert journal.read().tolist() == list(range(0, 2048, 2))
    journal.post(torch.arange(0, 2 * 1025, 2))
    assert journal.read() is None
    journal.post(torch.tensor([5]))
    assert journal.read().tolist() == [5]
    for row in range(1025):
        journal.post(torch.tensor([row]))
    assert journal.read() is None
