# SPDX-License-Identifier: Apache-2.0
"""A list of nothing: no line on standard output, which scripts count, and a note that says so."""

import pytest

from edgectl.model.manager_state import ManagerState
from edgectl.views.dry_run import RequestsView
from edgectl.views.events import EventsView
from edgectl.views.history import HistoryView
from edgectl.views.listing import ListingView
from edgectl.views.listing_items import Listing, ListingKind
from edgectl.views.output import ListView, render_view
from edgectl.views.output_format import OutputFormat
from edgectl.views.profile import ProfileView
from edgectl.views.status import StatusView
from edgectl.views.top_tasks import TopTasksView
from tests.builders import a_snapshot, an_edge, an_inventory, some_tasks

SNAPSHOT = a_snapshot(memory=ManagerState())
FLEET = an_inventory(an_edge("edge1"))
EMPTY: tuple[ListView, ...] = (
    EventsView([]),
    HistoryView([]),
    ListingView(Listing(kind=ListingKind.ROBOTS, at=SNAPSHOT.taken_at, items=())),
    ProfileView([]),
    RequestsView([]),
    StatusView(SNAPSHOT, FLEET, some_tasks()),
    TopTasksView(SNAPSHOT, FLEET, some_tasks(), ()),
)


@pytest.mark.parametrize("view", EMPTY, ids=lambda view: type(view).__name__)
def test_an_empty_list_prints_nothing_and_notes_it(view: ListView) -> None:
    assert render_view(view, OutputFormat.TABLE) == ""
    assert len(view.notes()) == 1
    assert view.document()["items"] == []
