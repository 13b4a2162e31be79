// Draws the trajectory that the element names, molecules as sticks and balls, and lets it run.
"use strict";
for (const place of document.querySelectorAll(".viewer")) {
  fetch(place.dataset.trajectory)
    .then((answer) => {
      if (!answer.ok) throw new Error(answer.status + " for " + place.dataset.trajectory);
      return answer.text();
    })
    .then((frames) => {
      place.textContent = "";
      const viewer = $3Dmol.createViewer(place, { backgroundColor: "white", disableFog: true });
      viewer.addModelsAsFrames(frames, "xyz");
      viewer.setStyle({}, { stick: { radius: 0.12 }, sphere: { scale: 0.22 } });
      viewer.zoomTo();
      viewer.render();
      viewer.animate({ loop: "backAndForth", interval: 60 });
      place.dataset.drawn = viewer.getModel().selectedAtoms({}).length;
    })
    .catch((error) => {
      place.textContent = "The trajectory could not be shown: " + error.message;
    });
}
