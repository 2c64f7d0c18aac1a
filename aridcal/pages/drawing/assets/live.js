"use strict";
// Added to a page by `aridcal view`: follows the result folder over meshcat's connection. The server sends a scene as an
// object at the path /calibration as soon as the folder holds another one than this page; see aridcal/view.py.
(() => {
  const scene = window.calibrationScene;
  const url = `ws://${location.host}/live?stamp=${document.currentScript.dataset.stamp}`;
  const say = (words) => {
    const mark = document.getElementById("live");
    if (mark) mark.textContent = words;
  };
  function redraw(data) {
    if (data?.script !== scene.script) return location.reload(); // written by another aridcal, or without a scene
    scene.show(data);
    say(`live, redrawn ${new Date().toLocaleTimeString()}`);
  }
  let connection;
  if (scene) {
    const { viewer } = scene;
    const usual = viewer.handle_command;
    viewer.handle_command = function (command) {
      if (command.path === "/calibration") redraw(JSON.parse(command.object));
      else usual.call(viewer, command);
    };
    viewer.connect(url);
    connection = viewer.connection;
  } else {
    connection = new WebSocket(url);
    connection.onmessage = () => location.reload();
  }
  connection.onopen = () => say("live");
  connection.onclose = () => say("aridcal view has ended");
})();
