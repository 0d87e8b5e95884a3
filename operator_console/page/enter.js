// Show that the last token was wrong.
document.getElementById("wrong").hidden = !location.search.includes("wrong");
