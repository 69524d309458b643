// A browser gives pages that are files no text of other pages, which the search would show below each title.
if (location.protocol === "file:") DOCUMENTATION_OPTIONS.SHOW_SEARCH_SUMMARY = false;
