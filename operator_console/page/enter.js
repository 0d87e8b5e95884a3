// The question for a token: says so when the last one was wrong.
document.getElementById("wrong").hidden = !location.search.includes("wrong");
